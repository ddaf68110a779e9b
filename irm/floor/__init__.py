"""Where the base may be on the floor: free space, its raster and the distance transform."""
