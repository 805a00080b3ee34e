"""Simulated motion controllers in processes of their own, with faults on command.

Driver and simulator share no state: what the driver knows comes over the line. Faults and the true position go
another way, the process's standard input and output. The commands there, one a line, each answered by one line of
JSON, are those of `irodori.simulation.controllers.peer_server`.
"""
