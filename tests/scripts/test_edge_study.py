"""Edges without shading are where the exact curves are; the table of the study."""

import pytest

from extremal.scripts.edge_study import EdgeRow, camera_edge_study, edge_table, simple_edge_study


@pytest.mark.slow
def test_fixed_edges_and_backlit_silhouettes_are_unbiased() -> None:
    rows = simple_edge_study(2)
    assert {row.name for row in rows} == {"box outline", "box creases", "backlit sphere", "backlit lathe"}
    for row in rows:
        assert row.edgels > 150
        assert abs(row.bias_px) < 0.01
        assert row.coverage > 0.85
        assert row.edgel_sd_px < 2 * row.bound_px


@pytest.mark.slow
def test_other_cameras_see_edges_where_they_are() -> None:
    """Distortion, gamma, vignetting and drift: no bias above 0.02 px. (Moving cameras smear edges; docs/egomotion.md.)"""
    rows = [row for row in camera_edge_study(2) if "moving" not in row.name]
    assert len(rows) == 20
    for row in rows:
        if row.edgels > 150:
            assert abs(row.bias_px) < 0.02
            assert row.coverage > 0.8


def test_table_has_a_line_for_every_row() -> None:
    row = EdgeRow("sphere limb", "dark", "45", 12, -0.01, 0.02, 0.03, 0.95, 0.04, 0.05)
    lines = edge_table([row]).splitlines()
    assert len(lines) == 3
    assert (
        lines[2] == "| sphere limb | dark | 45 | 12 | -0.0100 | 0.0200 | 0.0300 | 95.0% | 0.0400 | 0.0500 |"
    )
