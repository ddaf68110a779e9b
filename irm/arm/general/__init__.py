"""Exact inverse kinematics of any arm: closed forms by subproblems, scanned over the free joint and the lift."""
