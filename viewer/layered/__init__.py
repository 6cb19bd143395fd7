"""Layered depth images: made of pictures, kept as bytes, warped to where viewers are (Aliaga & Lastra 1999, section 4)."""
