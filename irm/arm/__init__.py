"""An arm on its base: kinematics, closed-form and numerical inverse kinematics, manipulability."""
