"""A small, valid data set as text, for the tests to bend and break."""

import dataclasses

from numpy.testing import assert_array_equal

ROBOT = """\
name: small
sections: [{name: bending, cells: 3, cell_length: 0.01, bending_stiffness: 0.02}]
tendons:
- {name: left, offset: [0.005, 0.0], section: bending}
- {name: right, offset: [-0.005, 0.0], section: bending}
tension_limits: [0.0, 5.0]
gravity: [0.0, 0.0, 9.81]
"""
DATASET = 'robot: robot.yaml\ninput: tension\n'
INPUTS = 'posture,left,right\n0,0.5,0.0\n1,1.0,0.25\n'
SHAPES = """\
posture,trial,marker,x,y,z
0,0,1,0.001,0.0,0.01
0,0,2,0.002,0.0,0.02
0,0,3,0.003,0.0,0.03
0,1,1,0.001,0.0,0.01
0,1,2,0.002,0.0,0.02
0,1,3,0.005,0.0,0.03
1,0,1,0.002,0.0,0.01
1,0,3,0.006,0.0,0.028
"""
TEXTS = {
    'dataset.yaml': DATASET,
    'robot.yaml': ROBOT,
    'inputs.csv': INPUTS,
    'shapes.csv': SHAPES,
}


def write(folder, **changed):
    """Write the data set; `shapes='...'` replaces shapes.csv, None leaves a file out."""
    folder.mkdir(exist_ok=True)
    for name, text in TEXTS.items():
        text = changed.get(name.partition('.')[0], text)
        if text is not None:
            data = text if isinstance(text, bytes) else text.encode()
            (folder / name).write_bytes(data)
    return folder


def assert_same(copy, data):
    """Compare all but names and descriptions."""
    for field in dataclasses.fields(data):
        if field.name not in ('name', 'robot'):
            assert_array_equal(getattr(copy, field.name), getattr(data, field.name), field.name)
