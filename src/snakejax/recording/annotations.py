"""What `[[runs]]` says of a recording that its file does not say itself."""

from snakejax.core.toml_table import Table

from .readers import ANGLES, UPRIGHT, X_AXIS_DIRECTIONS, FileAnnotations

ANNOTATION_KEYS = ("columns", "units", "up", "markers", "x_axis", "angles")


def annotations_of(row: Table) -> FileAnnotations:
    """What the run says of its file that the file does not say itself."""
    columns, units = (
        row.texts(key, example) if key in row.values else None
        for key, example in (("columns", 'columns = {time = "name", ...}'), ("units", 'units = {length = "mm", ...}'))
    )
    markers = None
    if "markers" in row.values:
        example = "markers = {name = [x, y, z], ...}"
        table = row.table("markers", example)
        markers = {name: table.vector(name, 3, f"{name} = [x, y, z] in m") for name in table.values}
    up = row.values.get("up")
    if isinstance(up, list):
        up = row.vector("up", 3, "up = [0.0, 0.0, 1.0]")
        if not any(up):
            raise row.error("up", "has no direction", 'write up = "z" or the components of what points up')
    elif up is not None:
        up = row.choice("up", tuple(UPRIGHT))
    x_axis = row.choice("x_axis", tuple(X_AXIS_DIRECTIONS)) if "x_axis" in row.values else "forward"
    angles = row.choice("angles", ANGLES) if "angles" in row.values else None
    return FileAnnotations(columns, units, up, markers, x_axis, angles)
