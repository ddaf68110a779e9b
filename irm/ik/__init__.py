"""Inverse kinematics: closed forms, iteration, and exact answers whether an arm reaches a pose."""

from __future__ import annotations
