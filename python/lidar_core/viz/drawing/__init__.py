"""What pictures share: the part of the world they show, numbers of tracks, scale bars."""
