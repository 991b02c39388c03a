// The loops a careful programmer writes first, for benchmarks/direct.py to compare with.
// Velocities of the first m of n points. g++ -O3 -march=native -ffast-math -shared -fPIC
#include <cmath>

extern "C" void regularized_stokeslet(long m, long n, double epsilon, const double* x, const double* y,
                                      const double* z, const double* f, double* u) {
  const double *f1 = f, *f2 = f + n, *f3 = f + 2 * n;
  const double e2 = epsilon * epsilon, scale = 1 / (8 * M_PI);
  for (long i = 0; i < m; i++) {
    double u1 = 0, u2 = 0, u3 = 0;
    for (long j = 0; j < n; j++) {
      double dx = x[i] - x[j], dy = y[i] - y[j], dz = z[i] - z[j];
      double r2 = dx * dx + dy * dy + dz * dz, R2 = r2 + e2, inv = 1 / std::sqrt(R2);
      double h2 = inv / R2, h1 = (r2 + 2 * e2) * h2;
      double s = (f1[j] * dx + f2[j] * dy + f3[j] * dz) * h2;
      u1 += f1[j] * h1 + s * dx;
      u2 += f2[j] * h1 + s * dy;
      u3 += f3[j] * h1 + s * dz;
    }
    u[i] = u1 * scale, u[m + i] = u2 * scale, u[2 * m + i] = u3 * scale;
  }
}

extern "C" void regularized_stokeslet_rotlet(long m, long n, double epsilon, const double* x,
                                             const double* y, const double* z, const double* q,
                                             double* u) {
  const double *f1 = q, *f2 = q + n, *f3 = q + 2 * n;
  const double *n1 = q + 3 * n, *n2 = q + 4 * n, *n3 = q + 5 * n;
  const double e2 = epsilon * epsilon, e4 = e2 * e2, scale = 1 / (8 * M_PI);
  for (long i = 0; i < m; i++) {
    double u1 = 0, u2 = 0, u3 = 0, w1 = 0, w2 = 0, w3 = 0;
    for (long j = 0; j < n; j++) {
      double dx = x[i] - x[j], dy = y[i] - y[j], dz = z[i] - z[j];
      double r2 = dx * dx + dy * dy + dz * dz, R2 = r2 + e2, inv = 1 / std::sqrt(R2);
      double i3 = inv / R2, i5 = i3 / R2, i7 = i5 / R2;
      double h1 = (r2 + 2 * e2) * i3, q = 0.5 * (5 * e2 + 2 * r2) * i5;
      double d1 = 0.25 * (10 * e4 - 7 * e2 * r2 - 2 * r2 * r2) * i7;
      double d2 = 0.25 * (21 * e2 + 6 * r2) * i7 * (n1[j] * dx + n2[j] * dy + n3[j] * dz);
      double s = (f1[j] * dx + f2[j] * dy + f3[j] * dz) * i3;
      u1 += f1[j] * h1 + s * dx + q * (n2[j] * dz - n3[j] * dy);
      u2 += f2[j] * h1 + s * dy + q * (n3[j] * dx - n1[j] * dz);
      u3 += f3[j] * h1 + s * dz + q * (n1[j] * dy - n2[j] * dx);
      w1 += n1[j] * d1 + d2 * dx + q * (f2[j] * dz - f3[j] * dy);
      w2 += n2[j] * d1 + d2 * dy + q * (f3[j] * dx - f1[j] * dz);
      w3 += n3[j] * d1 + d2 * dz + q * (f1[j] * dy - f2[j] * dx);
    }
    u[i] = u1 * scale, u[m + i] = u2 * scale, u[2 * m + i] = u3 * scale;
    u[3 * m + i] = w1 * scale, u[4 * m + i] = w2 * scale, u[5 * m + i] = w3 * scale;
  }
}
