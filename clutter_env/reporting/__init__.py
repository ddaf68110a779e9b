"""Progress, files, tables and intervals of results: what commands and scripts share."""
