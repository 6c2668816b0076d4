"""What is kept of a course: made once, by identity, for the last courses only, by threads too."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from tests.grade.straight import straight
from tunefree_hil.base.course import Course
from tunefree_hil.grade.memo import CourseCache


def test_a_course_is_worked_out_once() -> None:
    made: list[Course] = []
    kept = CourseCache(lambda course: made.append(course) or len(made))
    first, other = straight(5.0), straight(5.0)
    assert [kept(first), kept(first), kept(other), kept(first)] == [1, 1, 2, 1]
    assert made[0] is first and made[1] is other, (
        "equal courses are two, or every look would compare thousands of numbers"
    )


def test_only_the_last_are_kept() -> None:
    made: list[Course] = []
    kept = CourseCache(lambda course: made.append(course) or len(made), max_courses=2)
    courses = [straight(speed) for speed in (1.0, 2.0, 3.0)]
    assert [kept(course) for course in courses] == [1, 2, 3]
    assert [kept(course) for course in reversed(courses)] == [3, 2, 4]


def test_threads_that_add_while_others_look() -> None:
    courses = [straight(1.0 + 0.1 * i) for i in range(12)]
    kept = CourseCache(lambda course: course.speed_mps[0], max_courses=4)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda i: kept(courses[i % 12]), range(4000)))
    assert found == [courses[i % 12].speed_mps[0] for i in range(4000)]
