"""Result folders: what is written into them, read back and compared.

Begin with ``store``, one folder, on ``result_tables`` and ``tables``, which survive a kill and a full disk.
``environment`` says where results come from, ``failures`` what went wrong, ``images`` are EXR and PNG; ``summary``,
``published``, ``prediction`` and ``compare`` are made from stored tables alone.
"""
