"""Checks of a rig's motion block: channels, templates and regular expressions."""

import itertools
import re

from irodori.capture.rig.ascii_description import COMMANDS, OPTIONAL, REPLIES, SAMPLES, STATES, placeholders
from irodori.config.models import AsciiProtocol, Motor, Rig
from irodori.core.errors import InputError

_GRBL_LETTERS = "XYZABC"


def check_motion(rig: Rig, file) -> None:
    """Refuse a block ``motion`` that contradicts itself or that its protocol cannot use.

    Parameters
    ----------
    rig : Rig
    file : path
        File of the rig's definition, for the error message.

    Raises
    ------
    InputError
        For the first fault.
    """
    motion = rig.motion
    if motion is None:
        return
    seen: dict[str, str] = {}
    axes: dict[str, Motor] = motion.axes.given()
    for name, axis in axes.items():
        field, channel = f"motion.axes.{name}", axis.channel
        if channel in seen:
            raise InputError(
                file, f"{field}.channel", f"{channel!r}, which {seen[channel]} has", "a channel of its own"
            )
        seen[channel] = name
        if axis.units_per_deg == 0:
            raise InputError(file, f"{field}.units_per_deg", "0", "a number above or below 0")
        if motion.protocol == "grbl" and (len(channel) != 1 or channel not in _GRBL_LETTERS):
            raise InputError(file, f"{field}.channel", repr(channel), f"one of {', '.join(_GRBL_LETTERS)}")
        if motion.protocol == "ascii" and not re.fullmatch(r"[!-~]+", channel):
            raise InputError(file, f"{field}.channel", repr(channel), "ASCII letters, digits and signs without spaces")
    if motion.protocol == "grbl":
        if motion.ascii is not None:
            raise InputError(file, "motion.ascii", "a key that the protocol grbl does not use", "to leave it out")
    elif motion.ascii is None:
        raise InputError(file, "motion.ascii", "no such key", "this key, because the protocol is ascii")
    else:
        _check_ascii(motion.ascii, [axis.channel for axis in axes.values()], file)


def _check_ascii(block: AsciiProtocol, channels: list[str], file) -> None:
    for command, (needed, allowed) in {**COMMANDS, **OPTIONAL}.items():
        template = getattr(block, command)
        if template is None:
            continue
        field = f"motion.ascii.{command}"
        # With several axes, a move and a position must name their axis.
        must = {*needed, *(("axis",) if len(channels) > 1 and command in ("move", "position") else ())}
        _check_template(template, must, {*needed, *allowed}, file, field)
    patterns = {}
    for reply, text in block.replies.given().items():
        field = f"motion.ascii.replies.{reply}"
        try:
            patterns[reply] = re.compile(text, re.ASCII)
        except (re.error, RecursionError, OverflowError) as error:
            raise InputError(file, field, f"{text!r} ({error})", "a regular expression of Python") from None
        for group in REPLIES[reply]:
            if group not in patterns[reply].groupindex:
                accepted = f"a regular expression with the group (?P<{group}>...)"
                raise InputError(file, field, repr(text), accepted)
    _check_words(block, file)
    for reply in block.simulated_replies.given():
        _check_simulated(block, reply, patterns, channels, file)


def _check_template(text: str, needed: set[str], allowed: set[str], file, field: str) -> str:
    """Return a template filled with sample values, after a check of its placeholders."""
    try:
        found = set(placeholders(text))
        filled = text.format(**{name: SAMPLES[name] for name in allowed}) if found <= allowed else ""
    except (ValueError, KeyError, IndexError, AttributeError, TypeError) as error:
        accepted = "a template with placeholders such as {axis} and {target:.3f}"
        raise InputError(file, field, f"{text!r} ({error})", accepted) from None
    if not (needed <= found <= allowed):
        listed = ", ".join("{" + name + "}" for name in sorted(needed)) or "none"
        others = ", ".join("{" + name + "}" for name in sorted(allowed)) or "none"
        raise InputError(file, field, repr(text), f"the placeholders {listed}, and of others only {others}")
    if not re.fullmatch(r"[ -~]+", filled):
        raise InputError(file, field, repr(text), "printable ASCII")
    return filled


def _check_words(block: AsciiProtocol, file) -> None:
    seen: dict[str, str] = {}
    for state in STATES:
        for index, word in enumerate(getattr(block, state)):
            if word in seen:
                found = f"{word!r}, a word of {seen[word]} as well"
                raise InputError(file, f"motion.ascii.{state}[{index}]", found, "each word for one state")
            seen[word] = state
    if block.resume is not None and not block.hold:
        accepted = "the controller's words for a feed hold, because there is motion.ascii.resume"
        raise InputError(file, "motion.ascii.hold", "no words", accepted)


def _check_simulated(block: AsciiProtocol, reply: str, patterns: dict, channels: list[str], file) -> None:
    field, text = f"motion.ascii.simulated_replies.{reply}", getattr(block.simulated_replies, reply)
    if reply not in patterns:
        raise InputError(file, field, "a reply without a regular expression", f"motion.ascii.replies.{reply} beside it")
    needed = set(REPLIES[reply])
    allowed = {"position": {"axis", "position"}, "status": {"axis", "state"}, "refused": {"message"}}.get(reply, set())
    _check_template(text, needed, allowed, file, field)
    states = [word for state in STATES for word in getattr(block, state)] if reply == "status" else [SAMPLES["state"]]
    for state, channel in itertools.product(states, channels):
        filled = text.format(**{**SAMPLES, "state": state, "axis": channel})
        found = patterns[reply].fullmatch(filled)
        if not found or (reply == "status" and found["state"] != state):
            accepted = f"what motion.ascii.replies.{reply} matches whole: {patterns[reply].pattern}"
            raise InputError(file, field, f"{filled!r}", accepted)
