"""The data that is shipped for scenes that need clearing: tables of side approaches, and suites of scenes."""
