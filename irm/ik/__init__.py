"""Inverse kinematics: closed forms, iteration, and exact decisions whether an arm reaches a pose."""

from __future__ import annotations
