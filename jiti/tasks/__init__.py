"""What was asked, its Implicit Task Constraints, and the catalogues that list them."""
