"""Checks and measurements that are run as scripts."""
