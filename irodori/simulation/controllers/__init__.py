"""Simulated motion controllers as separate processes, with faults on command.

Driver and simulator share no state: the driver learns everything over the serial line. Tests inject faults and read the
true position through standard input and output of the process. Each command there is one line, answered by one line of
JSON; `irodori.simulation.controllers.peer_server` lists them.
"""
