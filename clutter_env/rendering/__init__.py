"""Camera images and films of episodes."""
