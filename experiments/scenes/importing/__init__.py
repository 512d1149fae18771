"""Whole scenes from files of other programs: glTF, USD and Mitsuba XML, a file per format.

Every format's ``read`` gives one neutral description (``description``), in the file's own units and axes;
``building`` turns it into the meshes, lights and cameras of ``wkernels.scene``. What a file has and is not brought in
is told, never dropped in silence. Begin with ``building.import_file``.
"""
