"""Progress, files, tables and intervals of results, shared by commands and scripts."""
