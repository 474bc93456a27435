package edu.wpi.first.math.numbers;

public class N3 {}
