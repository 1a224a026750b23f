"""The only room that opens or writes a GeoTIFF."""
