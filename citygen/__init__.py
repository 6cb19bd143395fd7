"""Cities to order: generated street networks, blocks, buildings and relief, for tests, demonstrations and benchmarks."""
