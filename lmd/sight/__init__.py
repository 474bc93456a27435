"""Coverage geometry: landmarks that a camera sees, and the probability P_n of seeing at least n of them.

An *axis* is one orientation of the camera, given by two unit vectors: the optical axis, and the direction to the right
in the image. A set of axes is a bit set; 64 axes share a *word*, a 64-bit integer. A *model of sight* has the
visibility criteria compiled for one camera (`lmd.scene.criteria.SightModel`). The *horizon* of a model is the distance
beyond which a landmark is neither seen nor hides another landmark. *Quantised* probabilities are integers, in units of
1 / `lmd.sight.kernels.PROBABILITY_ONE`, whose sums are exact.
"""
