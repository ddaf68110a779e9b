"""Table 1 of Lee & Kim 2019 and more: strategies compared on scenes that need clearing."""
