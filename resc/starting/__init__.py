"""How a script begins: composed, checked, told apart from other runs."""
