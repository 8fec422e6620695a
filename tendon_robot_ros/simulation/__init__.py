"""
All that plays reality: what a robot does that its description does not say.

plant.py          the robot as it really is: finer cells, other laws, something hidden
imperfect.py      how well it is built: scatter, kinks, gains, holes, registration
hidden.py         what may be hidden: effects of the catalogue, causes and laws outside it
measurements.py   a plant as a tracker and load cells would see it
raw_table.py      the same as a laboratory logs it: a table over time, in the tracker's frame
rehearsal.py      which cause `make live` hides, the tour that shows it, and its story

Nothing that controls or diagnoses a real robot imports from here.
"""
