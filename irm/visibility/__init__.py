"""From which bases a camera of the robot sees the target at the grasp."""
