"""Pictures of a plan, with matplotlib. No other room imports this one."""
