"""Where the base fits on the floor: free space, its raster and the distance to what is not free."""
