"""Evaluation: policies play fixed scenes; results files, tables and pictures of their scores."""
