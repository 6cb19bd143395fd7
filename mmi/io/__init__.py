"""Cities in: OpenStreetMap extracts and GIS files become a :class:`mmi.city.City`, with a report of what was done to them."""
