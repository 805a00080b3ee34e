"""Meanings of Grbl 1.1's error, alarm and setting numbers, from its documentation (gnea/grbl, doc/csv)."""

#: ``error:N``, the answer to a refused line.
ERRORS = {
    1: "G-code words consist of a letter and a value, and the letter was not found",
    2: "the value of a G-code word is missing or is not a number",
    3: "this '$' command is not recognised or not supported",
    4: "a negative value was given where a positive one is expected",
    5: "homing is not enabled in the settings ($22)",
    6: "the step pulse must be longer than 3 microseconds ($0)",
    7: "the EEPROM could not be read, and its defaults were restored",
    8: "this '$' command needs the controller to be idle",
    9: "G-code is locked out during an alarm or a jog",
    10: "soft limits ($20) need homing ($22)",
    11: "the line is longer than the controller takes, and was not executed",
    12: "the setting would exceed the step rate that the controller can do",
    13: "the safety door was opened",
    14: "the build information or start-up line is too long and was not stored",
    15: "the target of the jog is beyond the machine's travel",
    16: "a jog without '=', or with G-code that a jog may not hold",
    17: "laser mode needs an output with pulse-width modulation",
    20: "an unsupported or invalid G-code command",
    21: "two G-code commands of one modal group in a line",
    22: "the feed rate is not set",
    23: "a G-code command needs a whole number",
    24: "two G-code commands in a line need the axis words",
    25: "a G-code word is repeated in the line",
    26: "a G-code command needs axis words, and there are none",
    27: "the line number is invalid",
    28: "a G-code command lacks a value word",
    29: "the work coordinate systems G59.1 to G59.3 are not supported",
    30: "G53 needs G0 or G1",
    31: "axis words that no command of the line uses",
    32: "an arc without axis words in its plane",
    33: "the target of the motion is invalid",
    34: "the radius of the arc is invalid",
    35: "an arc without offsets in its plane",
    36: "value words that no command of the line uses",
    37: "the tool length offset G43.1 is not for this axis",
    38: "the tool number is too large",
}

#: ``ALARM:N``, which the controller sends on its own.
ALARMS = {
    1: "a limit switch was hit; the position is probably lost",
    2: "the target is beyond the machine's travel (soft limit); the position is kept",
    3: "a reset while in motion; the position is probably lost",
    4: "the probe was not in its initial state",
    5: "the probe touched nothing within its travel",
    6: "homing failed: it was reset",
    7: "homing failed: the safety door was opened",
    8: "homing failed: pulling off did not clear the limit switch (raise $27, or check the wiring)",
    9: "homing failed: no limit switch within the search distance (raise $130 to $132, lower $27, or check the wiring)",
}

#: ``$N``, the settings that `$$` prints, with their units.
SETTINGS = {
    0: "step pulse time, microseconds",
    1: "step idle delay, milliseconds",
    2: "step pulse invert, mask",
    3: "step direction invert, mask",
    4: "invert step enable pin, boolean",
    5: "invert limit pins, boolean",
    6: "invert probe pin, boolean",
    10: "status report options, mask",
    11: "junction deviation, mm",
    12: "arc tolerance, mm",
    13: "report in inches, boolean",
    20: "soft limits enable, boolean",
    21: "hard limits enable, boolean",
    22: "homing cycle enable, boolean",
    23: "homing direction invert, mask",
    24: "homing locate feed rate, mm/min",
    25: "homing search seek rate, mm/min",
    26: "homing switch debounce delay, milliseconds",
    27: "homing switch pull-off distance, mm",
    30: "maximum spindle speed, RPM",
    31: "minimum spindle speed, RPM",
    32: "laser-mode enable, boolean",
    100: "X steps per mm",
    101: "Y steps per mm",
    102: "Z steps per mm",
    110: "X maximum rate, mm/min",
    111: "Y maximum rate, mm/min",
    112: "Z maximum rate, mm/min",
    120: "X acceleration, mm/s^2",
    121: "Y acceleration, mm/s^2",
    122: "Z acceleration, mm/s^2",
    130: "X maximum travel, mm",
    131: "Y maximum travel, mm",
    132: "Z maximum travel, mm",
}


def error_text(code: int) -> str:
    """Return an error code with its meaning, such as ``error:9 (G-code is locked out ...)``."""
    return f"error:{code} ({ERRORS.get(code, 'a code that Grbl 1.1 does not publish')})"


#: Code of the alarm of a limit switch.
HARD_LIMIT = 1


def alarm_text(code: int) -> str:
    """Return an alarm code with its meaning, such as ``ALARM:1 (a limit switch was hit ...)``."""
    return f"ALARM:{code} ({ALARMS.get(code, 'a code that Grbl 1.1 does not publish')})"
