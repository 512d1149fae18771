"""The kinds of experiment, a folder each: its schema, how it runs, what it explains, its report.

Begin with ``kind``: what a kind implements, and how folders are found; then with ``walkthrough``, on which convergence,
savings and sweep build. A new kind is a folder with a ``kind.py``; nothing else has to know of it. The others beside it
are alike everywhere: ``config``, ``run``, ``explain``, ``report`` with its ``page.html``.
"""
