"""How a scene is solved: the plan that chooses a method, and the methods."""
