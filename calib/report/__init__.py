"""The pages that people read afterwards: one house style, one file each, readable offline, printed, in the dark and by everyone."""
