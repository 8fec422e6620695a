"""CSV files that cannot be read, each with what is said about it."""

from small_dataset import INPUTS, SHAPES

# what is wrong -> file, its content, where and what the message says, and the remedy
BAD = {
    'no shapes.csv': (
        'shapes',
        None,
        'shapes.csv: cannot be read (No such file or directory)',
        'every data set needs this file',
    ),
    'no robot description': (
        'robot',
        None,
        'dataset.yaml: robot: no file d/robot.yaml',
        'put the robot description there or correct the path',
    ),
    'empty file': (
        'shapes',
        '',
        'shapes.csv: is empty',
        'start it with the line posture,trial,marker,x,y,z',
    ),
    'header only': (
        'shapes',
        SHAPES.split('\n')[0],
        'shapes.csv, row 2: there is no row below the header',
        'write one row per value',
    ),
    'unknown tendon': (
        'inputs',
        INPUTS.replace('right', 'middle'),
        "inputs.csv, row 1: column 'middle' is unknown",
        'rename it to one of posture, trial, left, right, visit, previous',
    ),
    'tendon without column': (
        'inputs',
        'posture,left\n0,1\n1,1\n',
        "inputs.csv, row 1: column 'right' is missing",
        'add it to the header',
    ),
    'no header': (
        'shapes',
        SHAPES.split('\n', 1)[1],
        'shapes.csv, row 1: this is no header',
        'start the file with the line posture,trial,marker,x,y,z',
    ),
    'column twice': (
        'shapes',
        SHAPES.replace('y,z', 'y,y'),
        "shapes.csv, row 1: column 'y' stands twice",
        'keep one of them',
    ),
    'nan written out': (
        'shapes',
        SHAPES.replace('0.005', 'nan'),
        "shapes.csv, row 7: x is 'nan'",
        'leave the cell empty where the marker was not seen',
    ),
    'infinity': (
        'inputs',
        INPUTS.replace('0.25', 'inf'),
        "inputs.csv, row 3: right is 'inf'",
        'write the value that was set',
    ),
    'number with underscore': (
        'shapes',
        SHAPES.replace('0.005', '0_005'),
        "shapes.csv, row 7: x is '0_005'",
        'write a number with a decimal point',
    ),
    'duplicate row': (
        'shapes',
        SHAPES + '0,1,3,0,0,0.03\n',
        "shapes.csv, row 10: posture '0', trial '1', marker '3' stands in row 7 too",
        'remove one of them',
    ),
    'positions in mm': (
        'shapes',
        SHAPES.replace('0.028', '28'),
        'shapes.csv, row 9: the marker is 28 m away, but the robot is only 0.03 m long',
        'write metres in the base frame (are these mm?)',
    ),
    'tensions in grams': (
        'inputs',
        INPUTS.replace('0.5', '51'),
        'inputs.csv, row 2: left is 51 N, but tension_limits end at 5 N',
        'raise tension_limits of the robot description to what was applied, or give N '
        '(0.5 N if in g or 0.051 N if in mN)',
    ),
    'negative tension': (
        'inputs',
        INPUTS.replace('0.5', '-0.5'),
        'inputs.csv, row 2: left is -0.5 N',
        'a tendon cannot push: write 0 or more',
    ),
    'empty tension': (
        'inputs',
        INPUTS.replace('0.25', ''),
        'inputs.csv, row 3: right is empty',
        'write 0 for a slack tendon (an empty cell means slack only with input: displacement)',
    ),
    'empty trial': (
        'shapes',
        SHAPES + '1,1,1,,,\n1,1,2,,,\n',
        "shapes.csv, row 10: posture '1', trial '1': no marker was seen in this trial",
        'remove its rows',
    ),
    'part of a position': (
        'shapes',
        SHAPES.replace('0.005,0.0,', '0.005,,'),
        'shapes.csv, row 7: only part of x, y, z is there',
        'write all three, or leave all three empty where the marker was not seen',
    ),
    'unknown marker': (
        'shapes',
        SHAPES + '1,0,4,0,0,0.03\n',
        "shapes.csv, row 10: marker '4': dataset.yaml has no such marker",
        'use one of 1, 2, 3',
    ),
    'unknown posture': (
        'shapes',
        SHAPES + '2,0,1,0,0,0.01\n',
        "shapes.csv, row 10: posture '2': inputs.csv has no such posture",
        'use one of 0, 1',
    ),
    'posture without shapes': (
        'inputs',
        INPUTS + '2,1,1\n',
        "inputs.csv, row 4: posture '2': shapes.csv has no such measurement",
        'add it there or remove this row',
    ),
    'trial without shapes': (
        'inputs',
        'posture,trial,left,right\n0,0,1,1\n0,1,1,1\n1,0,1,1\n1,1,1,1\n',
        "inputs.csv, row 5: posture '1', trial '1': shapes.csv has no such measurement",
        'add it there or remove this row',
    ),
    'Latin-1': (
        'shapes',
        SHAPES.replace('\n1,0,3', '\nü,0,3').encode('latin-1'),
        'shapes.csv, row 9: this is no UTF-8 text',
        'save the file as "CSV UTF-8"',
    ),
    'UTF-16': (
        'shapes',
        SHAPES.encode('utf-16'),
        'shapes.csv, row 1: this is no UTF-8 text',
        'save the file as "CSV UTF-8"',
    ),
    'NUL byte': (
        'shapes',
        SHAPES.replace('0.005', '\0'),
        'shapes.csv, row 7: this is no UTF-8 text',
        'save the file as "CSV UTF-8"',
    ),
    'semicolons and decimal commas': (
        'shapes',
        SHAPES.replace(',', ';').replace('.', ','),
        'shapes.csv, row 1: columns are separated by semicolons',
        'export with commas between columns and points in numbers',
    ),
    'tabs': (
        'shapes',
        SHAPES.replace(',', '\t'),
        'shapes.csv, row 1: columns are separated by tabs',
        'export with commas between columns and points in numbers',
    ),
    'decimal comma': (
        'shapes',
        SHAPES.replace('0.005', '0,005'),
        'shapes.csv, row 7: 7 cells under 6 columns',
        'write every column, missing values as empty cells, and points in numbers',
    ),
    'decimal comma quoted': (
        'shapes',
        SHAPES.replace('0.005', '"0,005"'),
        "shapes.csv, row 7: x is '0,005'",
        'write a number with a decimal point',
    ),
    'blank line': (
        'shapes',
        SHAPES.replace('\n1,0,1', '\n\n1,0,1'),
        'shapes.csv, row 8: the line is empty',
        'remove it',
    ),
    'text behind a quotation mark': (
        'shapes',
        SHAPES.replace('0.005', '"0.005"m'),
        'shapes.csv, row 7: the quotation marks do not fit',
        'remove all that are on this line',
    ),
    'open quotation mark': (
        'shapes',
        SHAPES.replace('0.005', '"0.005'),
        'shapes.csv, row 7: the quotation marks do not fit',
        'remove all that are on this line',
    ),
    'empty name': (
        'shapes',
        SHAPES.replace('1,0,3', ',0,3'),
        'shapes.csv, row 9: posture is empty',
        'write a posture',
    ),
    'row of commas': (
        'shapes',
        SHAPES + ',,,,,\n',
        'shapes.csv, row 10: the line is empty',
        'remove it',
    ),
    'part of a quaternion columns': (
        'shapes',
        'posture,trial,marker,x,y,z,qx,qy\n0,0,1,0,0,0,0,0\n',
        'shapes.csv, row 1: qx, qy alone are no quaternion',
        'write qx, qy, qz, qw, or none of them',
    ),
    'a spreadsheet file': (
        'shapes',
        b'PK\x03\x04\x14\0\x06\0\x08\xff',
        'shapes.csv, row 1: this is no UTF-8 text',
        'save the file as "CSV UTF-8"',
    ),
}
