"""Flying objects of many sizes and speeds, and all that moves beside them."""
