"""Parts of reports that several kinds share: figures, pictures, data for scripts, and how a page is made of them.

Pages are templates (templates/*.html and those of the kinds) with their style and scripts written into them: plain
JavaScript in one scope, in the order of ``page.SCRIPTS``. What a script shows it reads from JSON in the page, which
``data`` makes. Begin with ``page``; a kind's report is in its folder.
"""
