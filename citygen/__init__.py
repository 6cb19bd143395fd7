"""Generated cities: street networks, blocks, buildings and relief, for tests, demonstrations and benchmarks."""
