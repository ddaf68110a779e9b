"""Images of the cameras, films of episodes."""
