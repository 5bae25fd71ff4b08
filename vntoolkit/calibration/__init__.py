"""Floor 2, (colour, normal) pairs from a board, a ball, known lights or a head, and M from them."""
