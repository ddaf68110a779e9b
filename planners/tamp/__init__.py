"""Algorithm 1 of Lee & Kim 2019: task plans with references, bound to motions or refuted, then replanned."""
