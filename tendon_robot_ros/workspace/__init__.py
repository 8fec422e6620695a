"""
Where the tip can be, and which postures are worth a look.

grid.py            a grid of all tensions: tips at a view angle, families, files
constant_view.py   the exact postures that hold one view angle, and a look around along them
postures.py        postures to measure for a user who has none in mind
"""
