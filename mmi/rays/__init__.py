"""Rays through a city: what they hit first, and which of them meet nothing but sky."""
