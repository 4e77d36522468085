"""``navsim world edit``: a page on localhost where a world file is drawn, dragged and typed."""
