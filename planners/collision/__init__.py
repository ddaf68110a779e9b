"""Which objects does a configuration or a motion touch? Compiled checks of a scene, one bit per object."""
