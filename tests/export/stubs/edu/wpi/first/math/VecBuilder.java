package edu.wpi.first.math;

import edu.wpi.first.math.numbers.*;

public class VecBuilder { public static Matrix<N3, N1> fill(double a, double b, double c) { return new Matrix<>(new double[] {a, b, c}); } }
