"""The measurements behind the tables and figures of the documentation."""
