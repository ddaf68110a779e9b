"""What the learners share that fit a network to examples."""
