"""Task-planning problem (facts with references, transitions) and task planners."""
