"""Real scenes from packages: which there are, downloaded by the machine's own package tools, unpacked, verified.

Begin with ``fetching``. None of them is part of the project, and nothing needs them but the scenes that name them
(``fetched:NAME/FILE``). ``make scenes`` fetches all.
"""
