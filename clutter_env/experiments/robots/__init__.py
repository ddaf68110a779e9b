"""What a robot's data lack, what the robot reaches, and pictures of it."""
