"""Coverage geometry: which landmarks a camera sees, and with what probability at least n of them."""
