"""
All that plays reality: what a robot does that its description does not say.

plant.py          the robot as it really is: finer cells, other laws, something hidden
hidden.py         what may be hidden: effects of the catalogue, causes and laws outside it, and how
                  well the robot is built: scatter, kinks, gains, holes, registration
measurements.py   a plant as a tracker and load cells would see it; the same as a laboratory logs
                  it: a table over time, in the tracker's frame
rehearsal.py      which cause `make live` hides, the tour that shows it, and its story

Nothing that controls or diagnoses a real robot imports from here.
"""
