"""The table of expected failures in docs/peers.md names tests that exist. Run with the whole folder."""


class TestTable:
    """The rows of the table beside the tests collected."""

    def test_every_row_is_about_a_test(self, unmatched_rows):
        assert not unmatched_rows
