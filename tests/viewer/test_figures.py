"""Figures of objects without triangles, which scans are."""

import numpy as np
import pytest

from handsight import Camera, Contacts, ObjectModel, PosePrior, se3
from handsight.viewer.figures import CorrectionPanel, draw_corrections
from handsight.viewer.shapes import silhouette


@pytest.fixture(scope="module")
def box():
    """A box, and as a scan of it."""
    exact = ObjectModel.box([0.06, 0.09, 0.14])
    return exact, ObjectModel.from_points(*exact.sample(3000))


def test_a_scans_silhouette_has_the_depth_of_the_surface_in_front(box):
    camera = Camera(np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]]), (320, 240))
    T = se3.compose(se3.rotation_exp(np.array([0.4, 0.7, 0.2])), np.array([0.02, -0.01, 0.5]))
    exact, scanned = (silhouette(camera, model, T) for model in box)
    both = np.isfinite(exact) & np.isfinite(scanned)
    assert both.sum() > 0.98 * np.isfinite(exact).sum()
    assert np.isfinite(scanned).sum() < 1.15 * np.isfinite(exact).sum()
    assert np.quantile(np.abs(scanned[both] - exact[both]), 0.9) < 0.01


def test_a_correction_of_a_scan_is_drawn(box, tmp_path):
    pytest.importorskip("matplotlib")
    _, scanned = box
    points, normals = (each[:3] for each in scanned.sample(100))
    answer = {"position": [0.0, 0, 0], "quaternion_xyzw": [0.0, 0, 0, 1], "unobservable": [], "outliers": []}
    panel = CorrectionPanel(
        scanned, Contacts(points, normals), PosePrior(np.eye(4), np.eye(6)), answer | {"consistent": True}
    )
    draw_corrections([panel], tmp_path / "scan.png")
    assert (tmp_path / "scan.png").stat().st_size > 5_000
