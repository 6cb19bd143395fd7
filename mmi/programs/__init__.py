"""The programs ``build-impostors`` and ``inspect-layers``, and what all programs share (``command_line``)."""
