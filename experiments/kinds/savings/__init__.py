"""``kind: savings``: what leaving out work saves, rule by rule: each skip against the same frames without it."""
