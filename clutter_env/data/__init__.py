"""Demonstrations: record, replay, store and export episodes of an expert."""
