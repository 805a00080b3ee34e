"""Entry point of ``python -m irodori.rig``."""

from irodori.capture.command import main
from irodori.command_line import ended_quietly

raise SystemExit(ended_quietly(main))
