"""What we learn: excitation, preprocessing, identification, diagnosis, report, command line."""
