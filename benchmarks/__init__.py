"""wheelsight side by side with its peers, over the same frames on the same machine: `python -m benchmarks`.

__main__   the command: measure, judge, print, keep
sequences  the recordings to run over, and what their truth says of an estimate
contenders one small file each, behind a protocol; a new one is listed in its __init__
measure    one contender over one recording, in a process of its own
run        those processes, one after another, and the figures they give
wheels     how quick dead reckoning is
link       how quick the serial link is, and what bad lines (bad_lines) do to it
firmware   what the wheel controller takes of its chip, and how fast wheels it counts, simulated
startup    how long importing wheelsight and asking for its help take
parts      these four by their names, with their tables and targets
targets    what wheelsight must reach, met or missed by how much
machine    on what all this was measured
table      the figures as tables: in the terminal and in BENCHMARKS.md
"""
