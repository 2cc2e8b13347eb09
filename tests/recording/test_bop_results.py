"""Files of BOP's results: what is written is read, and what is wrong is told with its line."""

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidFile
from handsight.observation import PoseMeasurement
from handsight.recording import read_bop_results

GOOD = "48,1,5,0.93,1 0 0 0 1 0 0 0 1,10 -20 800,0.5"


def written(path, *lines):
    path.write_text("\n".join(["scene_id,im_id,obj_id,score,R,t,time", *lines]) + "\n")
    return path


def test_what_is_written_is_read(tmp_path):
    rng, lines, Ts = np.random.default_rng(0), [], se3.random(np.random.default_rng(1), 20)
    for k, T in enumerate(Ts):
        R, t = (" ".join(f"{v:.6f}" for v in part.ravel()) for part in (T[:3, :3], 1e3 * T[:3, 3]))
        lines.append(f"{k},{k + 1},{k + 2},{rng.random():.4f},{R},{t},-1")
    found = read_bop_results(written(tmp_path / "a.csv", *lines))
    assert [(one.scene, one.image, one.object) for one in found] == [(k, k + 1, k + 2) for k in range(20)]
    for one, T in zip(found, Ts, strict=True):
        np.testing.assert_allclose(one.T_camera_object, T, atol=2e-6)
        assert one.seconds is None
        PoseMeasurement(one.T_camera_object)  # which is what a tracker takes


def test_a_file_without_header_and_one_from_a_spreadsheet_are_read(tmp_path):
    (tmp_path / "a.csv").write_text(GOOD)
    (tmp_path / "b.csv").write_bytes(b"\xef\xbb\xbf" + GOOD.encode() + b"\r\n\r\n")
    for name in ("a.csv", "b.csv"):
        (one,) = read_bop_results(tmp_path / name)
        np.testing.assert_allclose(one.T_camera_object[:3, 3], [0.01, -0.02, 0.8])
        assert one.seconds == 0.5


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("48,1,5,0.93,1 0 0 0 1 0 0 0 1,10 -20 800", "expected 7 columns"),
        (GOOD.replace("48,", "four,"), "scene_id: expected a whole number, got 'four'"),
        (GOOD.replace("0.93", "nan"), "score: expected 1 finite number, got 'nan'"),
        (GOOD.replace("10 -20 800", "10 -20"), "t: expected 3 finite numbers, got '10 -20'"),
        (GOOD.replace("10 -20 800", "10 -20 1e99"), "t: translation: expected"),
        (GOOD.replace("1 0 0 0 1 0", "1 0 0 0 x 0"), "R: expected 9 finite numbers"),
        (GOOD.replace("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 -1"), "R: expected a rotation"),
        (GOOD.replace("1 0 0 0 1 0 0 0 1", "1e200 0 0 0 1 0 0 0 1"), "R: expected a rotation"),
        (GOOD + ',"', "expected 7 columns|unexpected end"),
    ],
)
def test_an_error_names_its_line(tmp_path, line, said):
    with pytest.raises(InvalidFile, match=r"a\.csv: line 3: (" + said + ")"):
        read_bop_results(written(tmp_path / "a.csv", GOOD, line))


def test_a_file_that_is_not_text_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "a.csv").write_bytes(bytes(range(256)))
    with pytest.raises(InvalidFile, match="expected text in UTF-8"):
        read_bop_results(tmp_path / "a.csv")
    with pytest.raises(InvalidFile, match="cannot be read"):
        read_bop_results(tmp_path / "missing.csv")
