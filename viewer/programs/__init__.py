"""The programs for those who walk: ``compare-impostors``."""
