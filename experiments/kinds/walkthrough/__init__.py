"""``kind: walkthrough``: every listed technique on the frames of a path, compared with a reference.

- ``run``: order of work, timing, storing; ``label_run``: one label on its way through the frames;
- ``explain``, ``foreseen``: what will run, and what will be left out, from declarations and scene facts alone;
- ``report``: summary.csv, plots and page from the stored files.
"""
