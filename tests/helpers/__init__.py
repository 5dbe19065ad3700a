"""What tests of several rooms share: cases, exports, results, folders and a browser. It holds no tests."""
