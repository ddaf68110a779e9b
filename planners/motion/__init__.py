"""Collision-free motions of arm and base, pick and place, timing, and the check of every path in MuJoCo."""
