"""What a window of the comparison viewer shows, without a network: what is asked for, the walk, and the pictures."""
