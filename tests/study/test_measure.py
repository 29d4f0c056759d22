"""Names of read-outs for a reader."""

import pytest

from cellsys.study.measure import read_out_name


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("crawl_um", "crawl, um"),
        ("matrix_speed_p99_under_cell_nm_s", "matrix speed p99 under cell, nm/s"),
        ("crawl_speed_um_per_s", "crawl speed, um/s"),
        ("last_switch_s", "last switch, s"),
        ("switches", "switches"),
    ],
)
def test_units_of_read_outs_are_written_out(key, name):
    assert read_out_name(key) == name
