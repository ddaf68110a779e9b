"""The task-planning problem: facts with references, transitions, and the task planners."""
