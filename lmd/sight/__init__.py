"""Coverage geometry: landmarks that a camera sees, and the probability P_n of seeing at least n of them."""
