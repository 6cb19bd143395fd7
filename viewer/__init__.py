"""Walking through a dataset of multi-mesh impostors, and measuring what a viewer sees."""
