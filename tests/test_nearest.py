from jiti.nearest import nearest


def test_a_name_is_answered_with_the_nearest_whatever_its_case():
    known = ("IsGrasping", "alpha")
    assert nearest("isgraspin", known) == "did you mean 'IsGrasping'? There are: IsGrasping, alpha"
    assert nearest("ALFA", known) == "did you mean 'alpha'? There are: IsGrasping, alpha"


def test_a_name_like_none_is_answered_with_all():
    assert nearest(7, ("one", "two")) == "there are: one, two"
