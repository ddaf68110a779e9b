"""The MuJoCo model, the controllers, and saved states."""
