"""What the commands of the command line do; each module imports what it needs when its command is used.

Begin with ``run``: run, explain and report, for all kinds of experiment alike. ``readme``, ``picture`` and ``coverage``
write parts of the documentation (``python -m experiments.commands.readme``).
"""
