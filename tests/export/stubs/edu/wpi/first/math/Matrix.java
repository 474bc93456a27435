package edu.wpi.first.math;

public class Matrix<R, C> { public double[] v; public Matrix(double[] v) { this.v = v; } }
