"""Versions of dataset.yaml that cannot be read, each with what is said about it."""

from small_dataset import DATASET

TIP = '{name: tip, arc_length: 0.03}'

# what is wrong -> file, its content, where and what the message says, and the remedy
BAD = {
    'no dataset.yaml': (
        'dataset',
        None,
        'dataset.yaml: cannot be read (No such file or directory)',
        'name a folder with dataset.yaml, inputs.csv and shapes.csv; of a table `import table` '
        'makes one',
    ),
    'pulls in mm': (
        'dataset',
        'input: displacement',
        'inputs.csv, row 2: left is pulled by 0.5 m, but the robot is only 0.03 m long',
        'write metres (is it in mm?)',
    ),
    'marker beyond the tip': (
        'dataset',
        DATASET + 'markers: [{name: tip, arc_length: 0.031}]',
        'dataset.yaml: markers[0].arc_length: got 0.031',
        'expected a finite number from 0 to 0.03 [m]',
    ),
    'offset in mm': (
        'dataset',
        DATASET + 'markers: [{name: a, arc_length: 0.03, offset: [0, 12, 0]}]',
        'dataset.yaml: markers[0].offset: got [0.0, 12.0, 0.0]',
        'expected at most three robot lengths [m] (is it in mm?)',
    ),
    'YAML boolean as name': (
        'dataset',
        DATASET + 'markers: [{name: y, arc_length: 0.03}, {name: on, arc_length: 0.03}]',
        'dataset.yaml: markers[1].name: got True',
        'expected a name (put it in quotes: YAML reads it otherwise)',
    ),
    'marker twice': (
        'dataset',
        DATASET + f'markers: [{TIP}, {TIP}]',
        "dataset.yaml: markers: got 'tip'",
        'expected names that differ',
    ),
    'unknown key': (
        'dataset',
        DATASET + 'gravty: [0,0,0]',
        "dataset.yaml: gravty: got 'gravty'",
        'expected one of robot, input, path, gravity, position_noise, tension_noise, accuracy, '
        'known, markers',
    ),
    'unknown input kind': (
        'dataset',
        'input: force',
        "dataset.yaml: input: got 'force'",
        'expected one of tension, displacement',
    ),
    'gravity in mm/s²': (
        'dataset',
        DATASET + 'gravity: [0,0,9810]',
        'dataset.yaml: gravity: got [0.0, 0.0, 9810.0]',
        'expected an acceleration in m/s², such as [0, 0, 9.81]',
    ),
    'noise in mm': (
        'dataset',
        DATASET + 'position_noise: 0.2',
        'dataset.yaml: position_noise: got 0.2',
        'expected a finite number from 1e-09 to 0.003 [m] (is it in mm?)',
    ),
    'noise in percent': (
        'dataset',
        DATASET + 'tension_noise: {trial: 4}',
        'dataset.yaml: tension_noise.trial: got 4',
        'expected a finite number from 0 to 0.5 [1]',
    ),
    'broken YAML': (
        'dataset',
        'robot: [robot.yaml',
        "dataset.yaml: is no valid YAML (line 1: expected ',' or ']', but got '<stream end>')",
        'correct that line',
    ),
    'tabs in YAML': (
        'dataset',
        'input:\ttension\n\tpath: x',
        "dataset.yaml: is no valid YAML (line 1: found character '\\t' that cannot start any "
        'token)',
        'correct that line',
    ),
}
