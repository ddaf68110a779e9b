"""Commands that make what is shipped with the packages: tables, suites, pictures."""
