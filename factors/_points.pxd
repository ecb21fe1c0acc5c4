cdef class Points:
    cdef readonly int count, coefficients, shared
    cdef const double[:, ::1] points, mean, normal, basis, along_normal, size_basis
    cdef const double[::1] sigma, along, origin, first, size, off_normal, odds
    cdef const int[:, ::1] neighbours
    cdef const int[:, :, ::1] grid
    cdef double spacing, share, vehicle
    cdef double ratio(self, int i, const double *shared) noexcept nogil
    cdef void place(self, int i, const double *R, const double *t, const double *shared, double *local) noexcept nogil
    cdef int nearest(self, const double *local, const double *sensor, const double *scale, bint *facing) noexcept nogil
    cdef bint is_near(self, const double *local, const double *size) noexcept nogil
    cdef double off(self, int k, const double *local, const double *x) noexcept nogil
    cdef void trace(
        self, const double *x, const double *size, const double *sensor, const double *scale, const double *unit,
        double *met
    ) noexcept nogil
    cdef double elsewhere(
        self, int i, const double *local, const double *size, const double *sensor, double far
    ) noexcept nogil
    cdef double peak(self, int i) noexcept nogil
    cdef int match_one(
        self, int i, const double *R, const double *t, const double *x, const double *shared, const double *size,
        const double *sensor, double *local, double *right, double *wrong, double *sigma
    ) noexcept nogil
    cdef void prepare(
        self, const double *R, const double *t, const double *x, double *size, double *sensor
    ) noexcept nogil
    cdef void row(
        self, int i, int k, const double *R, const double *local, const double *shared, double factor, double *J
    ) noexcept nogil
    cdef double add(
        self, const double *R, const double *t, const double *x, double *g, double *M, double *J
    ) noexcept nogil
