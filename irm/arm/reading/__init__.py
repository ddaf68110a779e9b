"""An arm read from a MuJoCo model."""
