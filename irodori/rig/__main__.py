"""The rig from the command line: ``python -m irodori.rig --help``."""

from irodori.rig.command import main

raise SystemExit(main())
