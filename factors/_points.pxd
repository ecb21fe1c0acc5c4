cdef class Points:
    cdef readonly int count, coefficients
    cdef const double[:, ::1] points, mean, normal, basis, along_normal, size_basis
    cdef const double[::1] sigma, origin, first, size, off_normal, odds
    cdef const int[:, ::1] neighbours
    cdef const int[:, :, ::1] grid
    cdef double spacing, share, vehicle
    cdef int match_one(
        self, int i, const double *R, const double *t, const double *x, const double *size, const double *sensor,
        double *local, double *right, double *wrong
    ) noexcept nogil
    cdef void prepare(
        self, const double *R, const double *t, const double *x, double *size, double *sensor
    ) noexcept nogil
    cdef double distance(self, int i, int k, const double *local, const double *x) noexcept nogil
    cdef double add(
        self, const double *R, const double *t, const double *x, double *g, double *M, double *J
    ) noexcept nogil
