# cython: language_level=3


cdef class Source:
    cdef readonly int rows, columns, judged
    cdef readonly tuple takes
    cdef int take(self, list takes) except -1
    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil
    cdef void judge(self, const double **at, bint look, double *found) noexcept nogil
