"""Cities to order: generated street networks and buildings."""
