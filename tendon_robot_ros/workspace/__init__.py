"""
Where the tip can be, and which postures are worth a look.

volume.py          all places that the tip reaches, over all tendons; what friction takes; where an
                   unfinished one goes on
streamed.py        the postures for it in chunks of bounded memory, on many processors
cubes.py           those places as cubes of space, and where the tip looks in each;
                   arms that run into themselves
grid.py            a grid of all tensions: tips at a view angle, families, files
constant_view.py   the exact postures that hold one view angle, and a look around along them
postures.py        postures to measure for a user who has none in mind
"""
