"""``kind: sweep``: every technique on several scenes, and who is worth the time.

Each scene is an ordinary walkthrough with a result folder of its own; everything over them (``pareto.csv``,
``equal_time.csv``, ``equal_error.csv``, ``recommendation.csv``, plots) is made from these folders alone.
"""
