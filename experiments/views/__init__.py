"""Views: pictures that show why a technique fails (Stingl 2011, chapter 5), rendered beside an experiment.

Begin with ``render``, which makes all that an experiment asks for; ``experiments.schema.view_kinds`` names them.
``subject`` gathers what one frame is pictured from; ``surfaces``, ``space``, ``light_maps`` and ``error_plot`` draw;
``sheet`` adds headings and scales.
"""
