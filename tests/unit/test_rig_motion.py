"""The motion of a rig: what its file must agree on with itself."""

import copy

import pytest
import yaml
from definitions import ROOT, put

from irodori.capture.rig.connect import open_rig
from irodori.config.cross_checks.rig_motion import check_motion
from irodori.config.definitions import read_yaml
from irodori.config.models import Rig
from irodori.config.validation import validate
from irodori.core.errors import InputError


def examples() -> dict[str, dict]:
    """Return the blocks ``motion`` of the documentation by their protocol."""
    found = {}
    for part in (ROOT / "docs" / "rig.md").read_text(encoding="utf-8").split("```yaml\n")[1:]:
        block = yaml.safe_load(part.split("```")[0])
        found[block["motion"]["protocol"]] = block["motion"]
    return found


EXAMPLES = examples()


def rig(motion: dict) -> Rig:
    return Rig.of(validate({**read_yaml(ROOT / "config/rigs/virtual.yaml"), "motion": motion}, "rig", "rig.yaml"))


def changed(protocol: str, path: str, value) -> Rig:
    """Return a rig with one key of its motion changed; ... removes it."""
    return rig(put(EXAMPLES[protocol], path, value))


@pytest.mark.parametrize("protocol", ["grbl", "ascii"])
def test_the_documentation_s_examples_are_in_order_and_move_on_the_simulator(protocol):
    motion = copy.deepcopy(EXAMPLES[protocol])
    motion["port"], motion["simulator"] = "simulator", {"time_scale": 200.0}
    example = rig(motion)
    check_motion(example, "rig.yaml")
    with open_rig(example) as opened:
        opened.home()
        opened.move({"camera_deg": 12.5})
        assert opened.position()["camera_deg"] == pytest.approx(12.5, abs=0.05)


def test_a_rig_without_motion_is_in_order():
    check_motion(Rig.of(validate(read_yaml(ROOT / "config/rigs/virtual.yaml"), "rig", "x")), "x")


@pytest.mark.parametrize(
    ("protocol", "path", "value", "found", "accepted"),
    [
        ("grbl", "axes.turn_deg.channel", "X", "'X', which camera_deg has", "a channel of its own"),
        ("grbl", "axes.turn_deg.channel", "Q", "'Q'", "one of X, Y, Z"),
        ("grbl", "axes.turn_deg.channel", "XY", "'XY'", "one of X, Y, Z"),
        ("grbl", "axes.turn_deg.units_per_deg", 0, "0", "above or below 0"),
        ("grbl", "ascii", EXAMPLES["ascii"]["ascii"], "does not use", "leave it out"),
        ("ascii", "ascii", ..., "no such key", "protocol is ascii"),
        ("ascii", "axes.turn_deg.channel", "a b", "'a b'", "without spaces"),
        ("ascii", "ascii.move", "MA {axis}", "'MA {axis}'", "{axis}, {target}"),
        ("ascii", "ascii.move", "MA {target:.3f}", "'MA {target:.3f}'", "{axis}, {target}"),
        ("ascii", "ascii.move", "MA {axis} {target:.3q}", ".3q", "a template"),
        ("ascii", "ascii.move", "MA {axis} {target", "'MA {axis} {target'", "a template"),
        ("ascii", "ascii.move", "MA {axis} {target.__class__}", "without a plain name", "a template"),
        ("ascii", "ascii.move", "MA {} {target}", "without a plain name", "a template"),
        ("ascii", "ascii.home", "HM {speed}", "'HM {speed}'", "of others only {axis}"),
        ("ascii", "ascii.stop", "ST\u00e9", "'STé'", "printable ASCII"),
        ("ascii", "ascii.position", "PO", "'PO'", "{axis}"),
        ("ascii", "ascii.replies.status", "(", "'('", "a regular expression of Python"),
        ("ascii", "ascii.replies.status", "S=(.*)", "'S=(.*)'", "(?P<state>...)"),
        ("ascii", "ascii.replies.position", "(?P<state>.*)", "(?P<state>.*)", "(?P<position>...)"),
        ("ascii", "ascii.busy", ["READY"], "'READY', a word of idle as well", "each word for one state"),
        ("ascii", "ascii.hold", ["READY"], "'READY', a word of idle as well", "each word for one state"),
        ("ascii", "ascii.hold", [], "no words", "because there is motion.ascii.resume"),
        ("ascii", "ascii.resume", "GO {axis}", "'GO {axis}'", "none"),
        ("ascii", "ascii.simulated_replies.accepted", "DONE", "'DONE'", "matches whole"),
        ("ascii", "ascii.simulated_replies.position", "{axis}", "'{axis}'", "{position}"),
        ("ascii", "ascii.replies.refused", ..., "without a regular expression", "motion.ascii.replies.refused"),
    ],
)
def test_a_fault_names_its_key(protocol, path, value, found, accepted):
    with pytest.raises(InputError) as caught:
        check_motion(changed(protocol, path, value), "rig.yaml")
    error = caught.value
    assert error.file == "rig.yaml" and found in error.found and accepted in error.accepted
    if "refused" not in path:
        assert error.field.startswith(f"motion.{path}")


def test_motion_is_for_rigs_that_are_driven_and_not_for_files():
    stand = {**read_yaml(ROOT / "config/rigs/copy-stand.yaml"), "motion": EXAMPLES["grbl"]}
    with pytest.raises(InputError) as caught:
        validate(stand, "rig", "rig.yaml")
    assert caught.value.field == "motion"
