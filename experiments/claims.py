"""What the paper claims about its method, measured, a sentence for each.

a  "If the contact is close to an edge, simply minimising the distance can give a wrong result; taking into
   account the normals, one also knows which face the robot is touching." Four contacts on different faces of
   a 60 x 90 x 140 mm box, all within 5 mm of an edge, or none within 15 mm of one. A contact is on the wrong
   face when, at the corrected pose, the face it lies on is not the one it was put on, for the better of all
   poses that the box' symmetry allows.
b  "By giving a large value to w_n, the orientation is adjusted to fit the normals more than the distance":
   the error of Levenberg-Marquardt with normals against w_n, on Table I's cube and cylinder.
c  "A local minimum close to the initial estimate is more likely the real pose than a global minimum": the
   paper's method from many starts. Of all poses where it came to rest, the one nearest to the initial
   estimate against the one of least cost (eq. 3 over the whole cloud). Errors as they are, and modulo
   symmetry.
d  "Moving the contacts and not the object avoids transforming all its points in every iteration", and
   "quaternions require less calculations than rotation matrices": medians of interleaved repeats, in NumPy.

Starts are 1 cm per axis and 12° off (a: 2 cm and 20° too), contacts have 0.5 mm and 2° of noise per axis; the
cloud has 2 000 points. Rates and means come with their standard error over grasps.
"""
