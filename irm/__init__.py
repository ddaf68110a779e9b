"""Where may the base stand so that the hand reaches? Reachability maps and their inverse."""
