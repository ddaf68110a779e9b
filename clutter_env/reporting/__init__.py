"""Statistics, tables and files of results."""
