"""The differences in the table of results that are counted."""

from __future__ import annotations

from scripts.table_differences import PAGE, is_shown, rates

TABLE = """# Results

| suite | a | b | c |
|---|---|---|---|
| `one`* | 1.00 | refused | 0.85 [0.77, 0.91] |
| `two` | **0.99** | – | **0.00 [0.00, 0.04]** |

| other | table |
"""


def test_the_rates_of_the_first_table_are_read() -> None:
    assert rates(TABLE) == {"one": [100, 85], "two": [99, 0]}
    assert len(rates(PAGE.read_text())) == 12


def test_small_differences_of_large_rates_are_not_shown() -> None:
    assert is_shown(85, 100)
    assert is_shown(100, 85)
    assert not is_shown(99, 97)
