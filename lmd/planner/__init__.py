"""Planning by hand: tags that are dragged over the surfaces of a room, with everything said at once that follows."""
