"""
The workspace of the tip, and postures to measure.

volume.py          all places that the tip reaches, over all tendons: postures in chunks of bounded
                   memory, on many processors; what friction takes; where an unfinished one goes on
cubes.py           those places as cubes of space, and where the tip looks in each;
                   arms that run into themselves
view_angle.py      postures at one view angle: a grid of tensions, families, files; the exact ones,
                   and a look around along them
postures.py        postures to measure for a user who has none in mind
"""
