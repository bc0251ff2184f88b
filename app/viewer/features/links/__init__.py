"""Links: the address of the page says what is shown, and opening it shows the same."""
