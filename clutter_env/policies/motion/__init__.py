"""The keyframe policy: executes picks and places with keyframes that a network predicts."""
