"""The report's lines on rig and lamp during the sessions."""

import json

from irodori.report.html_page import fragment
from irodori.report.sittings import sittings


def test_each_session_has_its_worst_figures_and_one_without_a_rig_no_line(tmp_path):
    records = {
        "jar": {
            "position": [
                {"photographs": 40, "lost_deg": {"camera_deg": 0.01, "turn_deg": 0.0}},
                {"photographs": 2, "lost_deg": {"camera_deg": -0.5, "turn_deg": 0.2}},
            ],
            "drift": [{"light": 1.01, "shift_px": 0.2}, {"light": 0.97, "shift_px": None}],
        },
        "room": {"position": [], "drift": []},
        "plate": {"position": [{"photographs": 7, "lost_deg": {"camera_deg": 0.0}}], "drift": []},
        "cup": {"position": [], "drift": [], "never_checked": ["a.cr2", "b.cr2"]},
    }
    paths = [tmp_path / name / "captures/session.json" for name in records]
    for path, record in zip(paths, records.values(), strict=True):
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(record))
    page = fragment("sittings.html.j2", sittings=sittings(paths))
    assert "room" not in page and page.count("<tr>") == 4
    for cells in (
        ("jar", 42, "–", "camera_deg -0.500, turn_deg +0.200", 0.97, 0.2),
        ("plate", 7, "–", "camera_deg +0.000", "–", "–"),
        ("cup", "–", 2, "–", "–", "–"),
    ):
        assert "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>" in page
    assert fragment("sittings.html.j2", sittings=[]).strip() == ""
