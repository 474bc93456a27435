"""Where the cameras of a robot go: its body, what each camera would see, and that as a problem for optimisers."""
